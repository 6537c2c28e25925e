"""What an impact is: its parameters, their units, and the files and ranges that give them."""
