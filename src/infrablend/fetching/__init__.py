"""Getting public datasets: resumable downloads, archives unpacked safely, their content checked."""
