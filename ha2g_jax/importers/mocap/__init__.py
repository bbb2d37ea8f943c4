"""Import of motion capture with speech: BVH files and SMPL-X poses, converted to the axes of a skeleton."""
