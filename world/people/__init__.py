"""The network that finds people in photos: other people's weights in our own form."""
