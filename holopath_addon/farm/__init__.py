"""Distribution of work over processes of one machine or many, which share a folder."""
