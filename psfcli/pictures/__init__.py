"""Pictures as all commands draw them: one look, PNG files that depend on the numbers alone."""
