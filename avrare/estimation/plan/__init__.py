"""Agreement between an estimator and the loop: plan, budget, forecast of cost and memory."""
