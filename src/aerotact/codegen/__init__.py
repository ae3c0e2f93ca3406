"""Law, Estimator or Ocp -> standalone C project -> shared library."""
