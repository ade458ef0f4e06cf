"""Lane-change model-predictive controller and trajectory planner in CasADi."""
