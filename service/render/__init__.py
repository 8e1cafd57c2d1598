"""From a render request to pixels: plan, passes, encoders."""
