"""Detectors that are compiled: ONNX files as score-only detectors, and shipped networks as ONNX files."""
