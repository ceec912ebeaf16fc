"""``python -m vo_service`` is the command ``kinect-vo``."""

from vo_service import main

if __name__ == "__main__":
    main()
