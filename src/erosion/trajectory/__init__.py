"""One impact, followed: by diffrax (`simulate`) or by the engine of the batches (`path`)."""
