"""The structured primal-dual interior-point engine."""
