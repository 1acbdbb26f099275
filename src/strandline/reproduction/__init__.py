"""What reproduces the published study: the posterior of the true model, and how surrogates of more runs approach it."""
