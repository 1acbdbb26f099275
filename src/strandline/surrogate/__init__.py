"""Gaussian-process surrogates."""
