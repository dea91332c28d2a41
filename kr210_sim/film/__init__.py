"""Pictures of recorded cycles: what is shown when, how it looks, and the process that draws it."""
