"""What a query is: its track, its guess, the pivot of its guess, and the motion that it asks for."""
