"""What the manual's pages are made with: pages of the catalogue, pictures, and terminals that ran."""
