"""Videos of speakers become clips: shots, poses, smoothing, words (HA2G, Appendix A)."""
