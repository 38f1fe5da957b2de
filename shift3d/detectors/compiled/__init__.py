"""Compiled detectors: ONNX files as score-only detectors, and export of shipped networks to ONNX files."""
