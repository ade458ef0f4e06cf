"""Design by probabilities: sensitivities, requirements on parameters, and synthesis of controllers."""
