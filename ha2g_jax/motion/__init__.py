"""Motion after generation: its type and file, resampling, control, export, videos and key frames."""
