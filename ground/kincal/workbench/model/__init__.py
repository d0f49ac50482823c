"""What a model may hold: effects, parameters and terms, the model file, and the term table for flight."""
