"""What is measured: workloads, timings in turns, tables and charts."""
