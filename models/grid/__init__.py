"""The grid: network, power flow, equilibrium, and the tables that the C plant reads."""
