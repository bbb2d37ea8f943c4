"""Import of videos of speakers as clips: shots, poses, smoothing, words (HA2G, Appendix A)."""
