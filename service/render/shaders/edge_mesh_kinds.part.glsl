// Kinds of lines, the more important first, as `passes.edge_mesh.Styles` has them.
const int NONE = -1, SILHOUETTE = 0, BOUNDARY = 1, RIDGE = 2, VALLEY = 3;
