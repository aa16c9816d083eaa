"""Object storage as output and input: `s3://`, `gs://` and `hf://` by way of fsspec."""
