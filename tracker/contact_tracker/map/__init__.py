"""The map: elements that the contacts of a recording have touched, with their joint covariance."""
