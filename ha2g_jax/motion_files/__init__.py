"""Reading of motion from files of any system."""
