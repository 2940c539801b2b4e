"""What registration reads of a query: volumes of the part and the kits, from depth or from truth."""
