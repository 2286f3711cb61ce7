"""A study of any grid: a design made from the grid alone, and the page that says what it is worth."""
