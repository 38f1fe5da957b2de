"""Signed distance functions of vehicles: samples, the DeepSDF decoder, meshes from it, codes for new meshes."""
