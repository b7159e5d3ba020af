"""Worlds from mesh files: .dae, .obj, .stl, .ply and .glb."""
