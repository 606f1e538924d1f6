"""Map: where the points of the scans are kept, and the one cloud that is made of them."""
