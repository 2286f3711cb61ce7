"""Many runs: what varies, rows, resumption."""
