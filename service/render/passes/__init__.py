"""The passes of a frame, one file each, named after what they make. `service.render.frame` orders them."""
