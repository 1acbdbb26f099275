"""Questions about a finished study: what next, which model, how many specimens, what if, are its intervals right?"""
