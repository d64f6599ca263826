"""What docs/ is made with: configuration of the site, pages from the code, figures of the prose, and the pictures."""
