"""Robot -> Model: symbolic equations of motion and the formulas that laws, estimators and OCPs share."""
