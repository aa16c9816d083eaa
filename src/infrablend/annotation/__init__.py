"""Labels: what of each new object is visible, and how that joins the labels that were there before."""
