"""The grid: network, power flow, equilibrium, and the tables of the C plant."""
