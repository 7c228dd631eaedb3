"""Many recordings: each becomes a Parquet file of its segments and a row of a summary (docs/batch.md).

``segmenting.segment_recording`` handles one; ``run`` applies it to all that are not done yet, in processes
(``processes``) or on a cluster (``cluster``), and ``dataset`` stores the results.
"""
