"""Silhouette edges from the search tree, and the contours they form."""
