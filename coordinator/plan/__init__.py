"""From a plan to jobs: plans by name or file, exact cells, draws, and the scenes they are drawn from."""
