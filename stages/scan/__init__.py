"""Stage 4: spin images of models and scene, correlated."""
