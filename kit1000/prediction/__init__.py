"""Running a method on the queries of a dataset: the catalog, the making of predictors, the run and its journal."""
