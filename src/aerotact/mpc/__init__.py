"""Model + ocp file -> Ocp: residuals, constraints, transcription."""
