"""Files: safe archives of arrays, atomic writing of files, the cache folder."""
