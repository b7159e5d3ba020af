"""Worlds from height maps: GeoTIFF, PNG and .npy files."""
