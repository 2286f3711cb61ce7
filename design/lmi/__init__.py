"""Linear matrix inequalities: expressions, problems, engines."""
