"""Detectors that other codebases trained: OpenPCDet's and mmdetection3d's PointPillars and CenterPoint on pillars."""
