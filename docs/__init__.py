"""The documentation; a package so that its tests can import ``docs._ext``."""
