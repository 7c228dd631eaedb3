"""The benchmark of the field: methods that label motion with contacts, scored against the same truth."""
