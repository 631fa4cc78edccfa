"""Stage 3: spin images of models and scene, correlated."""
