"""LMI synthesis of controllers."""
