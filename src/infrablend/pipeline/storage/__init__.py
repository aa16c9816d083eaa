"""Object storage as output and input: addresses such as `s3://bucket/run`, by way of fsspec."""
