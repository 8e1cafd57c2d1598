"""Several meshes in one picture: where they stand (`place`), what hides what (`order`), the layers (`plan`), the drawing (`draw`)."""
