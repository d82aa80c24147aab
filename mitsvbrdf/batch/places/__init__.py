"""Where captures lie and results appear: a folder that all workers see, or an object store."""
