"""The construction site: rooms of stud walls."""
