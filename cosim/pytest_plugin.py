"""pytest fixture `scenario`: run a scenario once per session and assert on what it did."""
