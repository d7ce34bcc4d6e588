//! cape-graph.
