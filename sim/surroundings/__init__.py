"""What lies between sky and antenna: walls, decks, tunnels, trees, and what they reflect."""
