"""Structure from motion by colour alone: the steps of `SfmOdometry`, one file each."""
