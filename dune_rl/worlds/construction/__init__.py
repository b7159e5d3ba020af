"""The construction world: a building site indoors, with rooms of plastered and stud walls."""
