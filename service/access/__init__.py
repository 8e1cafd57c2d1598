"""Who may do what, and how much of it: keys with scopes and limits, signed addresses, quotas."""
