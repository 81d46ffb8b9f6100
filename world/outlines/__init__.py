"""How the network of outlines is learned from real photos, as HED sees them, and from this world's rooms."""
