"""Questions asked of finished estimates and recorded drives; nothing here prints."""
