"""Preprocessing: uploads in, artifacts out."""
