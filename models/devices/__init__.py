"""Devices as files: exciters, governors, stabilizers, compensators, limiters and more, one TOML file each."""
