"""Beyond one process: work in pieces that many processes, on one machine or many, share by one folder."""
