"""Triangle meshes with textures from files of several formats."""
