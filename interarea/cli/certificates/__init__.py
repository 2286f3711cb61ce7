"""What is certified beside the linear loops of a family."""
