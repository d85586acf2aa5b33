"""Episodes as tools of the Model Context Protocol, for agents that are programs of other kinds."""
