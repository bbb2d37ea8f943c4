"""Motion after generation: the value and its file, resampling, control, export, videos and key frames."""
