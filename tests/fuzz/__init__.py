"""The damage campaign: every reader, command and output under damaged and hostile inputs. `make fuzz` runs it."""
