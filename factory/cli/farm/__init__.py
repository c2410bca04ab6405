"""Commands for many hosts: `coordinator`, `worker`, `gateway`, `gather`, `submit`, `keys`."""
