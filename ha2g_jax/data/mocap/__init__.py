"""Motion capture of people who speak: BVH files and SMPL-X poses as recordings in the axes of a skeleton."""
