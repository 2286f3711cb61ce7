"""Systems with delays and losses: roots, margins, conditions on signals."""
