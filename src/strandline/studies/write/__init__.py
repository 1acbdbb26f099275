"""What a study leaves behind, and copies of it: summary, tables, pictures, a result that is read again."""
