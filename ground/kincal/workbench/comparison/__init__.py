"""A model beside measurements, and the record of a fit for the model file."""
