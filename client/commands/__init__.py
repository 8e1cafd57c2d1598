"""The commands of `silhouette`, by area; `client.cli` lists them."""
