"""A user study of gestures: a site that participants answer in a browser, and a key that stays with its owner."""
