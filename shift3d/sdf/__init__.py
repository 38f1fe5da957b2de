"""Signed distance functions of vehicles: samples, the DeepSDF decoder, mesh extraction, auto-decoding of new meshes."""
