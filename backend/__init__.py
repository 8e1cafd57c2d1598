"""What service and worker both reach beyond their process: object store, artifact files, job queue, progress."""
