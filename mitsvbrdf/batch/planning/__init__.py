"""Before a large batch: what a material costs, measured, and what a thousand workers would do, simulated."""
