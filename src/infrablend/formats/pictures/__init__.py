"""Pictures and videos: found, decoded and encoded, in 8 and 16 bit."""
