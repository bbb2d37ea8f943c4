"""The latency-alignment curve: how well gestures fit the speech, by the look-ahead of the stream that makes them."""
