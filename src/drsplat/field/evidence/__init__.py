"""W and what it says: weights of Gaussians under masks, the columns of a view, and ways from votes to features."""
