"""Readers and writers: files on disk <-> objects in memory."""
