"""Devices as files: exciters, governors, stabilizers, compensators, one TOML file each."""
