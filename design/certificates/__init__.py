"""What is proven of a closed loop."""
