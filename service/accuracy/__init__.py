"""The measured ladder as an answer: JSON with its Pareto fronts, and a plot."""
