"""Evidence at one fit: is more than noise left, which effects or unnamed terms explain it."""
