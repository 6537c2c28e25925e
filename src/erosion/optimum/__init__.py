"""The angle at which most is removed, certified by every maximum and jump of V(α) between 0° and 90°."""
