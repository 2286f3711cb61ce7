"""What a run gives: result, delay ledger, metrics."""
