"""Everything that is not science: config, files, resume, recording, results, command line."""
