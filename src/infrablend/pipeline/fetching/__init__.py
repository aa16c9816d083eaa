"""Getting public datasets: files are downloaded, checked against what is known of them, and unpacked."""
