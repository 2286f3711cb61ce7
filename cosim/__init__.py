"""Co-simulation of FMUs with exact delays: master, scenarios, metrics, study."""
