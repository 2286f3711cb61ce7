"""Study of any grid: a design derived from the grid data alone, and the page of its results."""
