"""What docs/ is made with: the site's configuration, pages that are written from the code, and figures of the prose."""
