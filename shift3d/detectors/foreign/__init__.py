"""Detectors trained with other codebases: PointPillars and CenterPoint on pillars of OpenPCDet and mmdetection3d."""
